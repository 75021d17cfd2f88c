"""Network impairment: a proxy between master and slave with configurable defects."""
