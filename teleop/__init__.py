"""What both sides share: messages, link, clock, config, session, recording, view, command line."""
