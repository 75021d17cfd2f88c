"""`teleop diagnose`: diagnosis of model errors in measured data, with reports."""
