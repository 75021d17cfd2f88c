"""The transmission law: a sheath, its play operators, and the closed forms of the paper."""
