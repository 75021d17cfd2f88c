"""Two tendons that pull one joint, fitted together."""
