"""The CAN trigger: the commands of the Modbus face, on a CAN bus."""
