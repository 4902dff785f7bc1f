"""The master of a Modbus device: its link, its ticks, its registers, and who it says it is."""
