"""What measures or reproduces, and no session needs; run from a checkout."""
