"""A Robotiq gripper with two fingers, on Modbus and behind the text socket of its URCap."""
