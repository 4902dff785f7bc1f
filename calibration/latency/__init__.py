"""The constant delay of a source's stamps against the arm's, from crossings, pictures or counts."""
