"""What jobs with a laser tracker share: its noise as stated, where it stands, and a look that is checked."""
