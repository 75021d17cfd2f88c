"""Visualisation of a session, live or recorded, with Rerun."""

import os

# read when rerun is imported; its file sink warns of the footer that is left out on purpose
os.environ.setdefault("RUST_LOG", "warn,re_log_encoding::rrd::file_sink=error")
