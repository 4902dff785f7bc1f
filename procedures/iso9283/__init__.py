"""Job ``iso9283``: how accurately and how repeatably the arm gets to commanded poses, seen by a tracker."""
