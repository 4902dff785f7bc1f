"""Kinematic identification: an arm's true parameters from the places of reflectors in a laser tracker."""
