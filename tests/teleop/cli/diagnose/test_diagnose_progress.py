"""How far a diagnosis is: one bar on a terminal, one line a stage elsewhere."""

import io

from teleop.runtime.status_line import WIDTH, Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def shown(stream):
    with Progress(stream) as progress:
        for what in ("fitting", "trying"):
            for share in (0.0, 0.5, 1.0):
                progress(what, share)
    return stream.getvalue()


def test_on_a_terminal_it_is_one_line_that_is_gone_at_the_end():
    text = shown(Terminal())
    assert "\n" not in text
    assert f"[{'#' * (WIDTH // 2):<{WIDTH}}] trying" in text
    assert text.endswith("\r\x1b[K")


def test_the_remaining_time_follows_the_share_done():
    now = [0.0]
    stream = Terminal()
    progress = Progress(stream, lambda: now[0])
    now[0] = 10.0
    progress("fitting", 0.25)
    now[0] = 100.0
    progress("fitting", 0.5)
    assert "fitting, about 30 s left" in stream.getvalue()
    assert "fitting, about 2 min left" in stream.getvalue()
