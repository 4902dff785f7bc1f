"""Belt tracking: counts to travel, forecasts with their uncertainty, meeting point, belt calibration."""
