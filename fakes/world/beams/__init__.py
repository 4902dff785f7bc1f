"""Light beams across the cell, and the module that counts their edges."""
