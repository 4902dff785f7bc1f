"""The laser tracker: where it stands, what it can see and what it reads."""
