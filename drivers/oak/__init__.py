"""Depth camera of the OAK family; native library and detectors live in a child process."""

from drivers.oak.camera import OakCamera

__all__ = ["OakCamera"]
