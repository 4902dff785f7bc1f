"""The twin of the cell: one physical world, device servers on real protocols, and faults."""
