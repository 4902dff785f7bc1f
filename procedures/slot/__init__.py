"""Job `slot-insertion`: a part into a slot of a rack or out of it, where half a millimetre is free."""
