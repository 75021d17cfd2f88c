"""Recordings of sessions: write, read, replay."""
