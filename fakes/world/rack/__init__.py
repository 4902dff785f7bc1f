"""A rack with slots, the parts that go into them, and what a held part meets there."""
