"""One module or small package per device family; imports only ``cell``."""
