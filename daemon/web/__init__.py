"""The operator's page and its API: the cell as one JSON object, and requests to the same engine."""
