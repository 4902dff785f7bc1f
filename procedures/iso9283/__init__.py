"""Job ``iso9283``: how accurately and how repeatably the arm gets to commanded poses, seen by a tracker."""

from procedures.iso9283.procedure import Iso9283Test

__all__ = ["Iso9283Test"]
