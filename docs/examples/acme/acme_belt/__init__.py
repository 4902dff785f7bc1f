"""Devices and jobs of Acme for Cellward."""
