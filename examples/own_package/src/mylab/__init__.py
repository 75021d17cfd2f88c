"""What a laboratory has of its own."""
