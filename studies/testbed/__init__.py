"""What studies and tests start and drive: processes, a browser, a tendon to control."""
