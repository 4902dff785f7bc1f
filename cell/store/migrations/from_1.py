"""Schema 1 to 2: a calibration notes the model of the arm that it was made with."""

SQL = "ALTER TABLE calibrations ADD COLUMN arm_model TEXT;"
MISSING = "NULL AS arm_model"
