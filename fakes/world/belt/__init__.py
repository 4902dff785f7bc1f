"""The belt, its encoder, the items on it and the gripper that takes them."""
