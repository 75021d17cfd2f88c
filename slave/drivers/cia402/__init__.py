"""CANopen drives of profile CiA 402."""
