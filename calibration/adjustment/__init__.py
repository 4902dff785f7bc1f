"""The cell as one weighted adjustment: what differs from the model is an unknown with a prior."""
