"""What a plant's MQTT broker is told: the state of the cell, and each run that ended. Nothing is taken."""
