"""What a session looks like: messages from the link or a recording, shown or saved with Rerun."""

import os

# read when rerun is imported; its file sink warns of the footer that is left out on purpose
os.environ.setdefault("RUST_LOG", "warn,re_log_encoding::rrd::file_sink=error")
