"""What studies and tests start and drive: processes, strangers, a browser, a tendon to control."""
