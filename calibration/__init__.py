"""Pure mathematics: arrays in, dataclasses out. No asyncio, no I/O, no devices."""
