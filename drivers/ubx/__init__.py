"""u-blox receivers in their own protocol, UBX."""
