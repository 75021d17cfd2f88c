"""The drawings of docs/how-to/network.md, as SVG: `python -m docs.topology_drawings` writes them.

They carry their own light background, so they read the same on light and dark pages.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from html import escape
from pathlib import Path

IMAGES = Path(__file__).parent / "images"
_INK, _PAPER, _SOFT = "#1f2933", "#f7f9fb", "#5a6875"
_FILL = {"side": "#dbe9f8", "router": "#fbe3c0", "listener": "#e4ecd9"}
_WIDTH, _HEIGHT = 132, 44  # of a box


@dataclass(frozen=True)
class Box:
    """A process, by its centre."""

    x: float
    y: float
    title: str
    detail: str = ""
    kind: str = "side"


@dataclass(frozen=True)
class Machine:
    """A machine, room or site around boxes."""

    x: float
    y: float
    width: float
    height: float
    title: str


@dataclass(frozen=True)
class Line:
    """A connection, made by `start` to `end`."""

    start: Box
    end: Box
    label: str = ""


Part = Box | Machine | Line


def svg(width: float, height: float, title: str, parts: Iterable[Part]) -> str:
    """Return a drawing; machines below, then lines, then boxes."""
    parts = list(parts)
    body = [
        draw(part)
        for kind, draw in ((Machine, _machine), (Line, _line), (Box, _box))
        for part in parts
        if isinstance(part, kind)
    ]
    return "\n".join(
        (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" '
            f'width="{width:g}" height="{height:g}" role="img" '
            'font-family="system-ui, sans-serif" font-size="13">',
            f"<title>{escape(title)}</title>",
            '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" '
            f'markerHeight="8" orient="auto"><path d="M0 0L8 4L0 8z" fill="{_SOFT}"/></marker>'
            "</defs>",
            f'<rect width="{width:g}" height="{height:g}" rx="8" fill="{_PAPER}"/>',
            *body,
            "</svg>\n",
        )
    )


def _machine(machine: Machine) -> str:
    return (
        f'<rect x="{machine.x:g}" y="{machine.y:g}" width="{machine.width:g}" '
        f'height="{machine.height:g}" rx="6" fill="none" stroke="{_SOFT}" '
        'stroke-dasharray="5 4"/>'
        f'<text x="{machine.x + 8:g}" y="{machine.y + 17:g}" fill="{_SOFT}">'
        f"{escape(machine.title)}</text>"
    )


def _box(box: Box) -> str:
    left, top = box.x - _WIDTH / 2, box.y - _HEIGHT / 2
    lines = [(box.title, 0 if not box.detail else -7, _INK, 13)]
    if box.detail:
        lines.append((box.detail, 11, _SOFT, 11))
    texts = "".join(
        f'<text x="{box.x:g}" y="{box.y + dy + 4:g}" fill="{ink}" font-size="{size}" '
        f'text-anchor="middle">{escape(text)}</text>'
        for text, dy, ink, size in lines
    )
    return (
        f'<rect x="{left:g}" y="{top:g}" width="{_WIDTH}" height="{_HEIGHT}" rx="5" '
        f'fill="{_FILL[box.kind]}" stroke="{_INK}"/>{texts}'
    )


def _line(line: Line) -> str:
    (x1, y1), (x2, y2) = _edge(line.start, line.end), _edge(line.end, line.start)
    text = (
        f'<text x="{(x1 + x2) / 2:g}" y="{(y1 + y2) / 2 - 7:g}" fill="{_SOFT}" font-size="11" '
        f'text-anchor="middle">{escape(line.label)}</text>'
        if line.label
        else ""
    )
    return (
        f'<line x1="{x1:.4g}" y1="{y1:.4g}" x2="{x2:.4g}" y2="{y2:.4g}" stroke="{_SOFT}" '
        f'stroke-width="1.5" marker-end="url(#tip)"/>{text}'
    )


def _edge(box: Box, other: Box) -> tuple[float, float]:
    """Return where the line from the centre of `box` towards `other` leaves the box."""
    dx, dy = other.x - box.x, other.y - box.y
    reach = min(
        (half / abs(step) for half, step in ((_WIDTH / 2, dx), (_HEIGHT / 2, dy)) if step),
        default=0.0,
    )
    return box.x + dx * reach, box.y + dy * reach


def one_machine() -> str:
    """Return the drawing of both sides on one machine."""
    master, slave = (
        Box(110, 80, "master", "127.0.0.1, free port"),
        Box(350, 80, "slave", "likewise"),
    )
    recorder = Box(110, 170, "recorder", kind="listener")
    viewer = Box(350, 170, "viewer", kind="listener")
    parts = (
        Machine(14, 14, 432, 198, "one machine: teleop run"),
        *(master, slave, recorder, viewer),
        Line(master, slave),
        *(Line(one, side) for one in (recorder, viewer) for side in (master, slave)),
    )
    return svg(460, 226, "Master, slave, recorder and viewer on one machine", parts)


def lan() -> str:
    """Return the drawing of console and robot on one network."""
    master, slave = (
        Box(110, 80, "master", "10.0.0.10:7451"),
        Box(410, 80, "slave", "10.0.0.20:7452"),
    )
    viewer, recorder = (
        Box(110, 160, "viewer", kind="listener"),
        Box(410, 160, "recorder", kind="listener"),
    )
    parts = (
        *(Machine(14, 14, 192, 186, "console"), Machine(314, 14, 192, 186, "robot")),
        *(master, slave, viewer, recorder),
        Line(master, slave, "mutual TLS"),
        *(Line(one, side) for one in (viewer, recorder) for side in (master, slave)),
    )
    return svg(520, 214, "Console and robot connected directly", parts)


def router() -> str:
    """Return the drawing of console and robot at a router."""
    middle = Box(330, 80, "router", "10.0.0.5:7450", "router")
    master, slave = Box(100, 80, "master", "no open port"), Box(560, 80, "slave", "no open port")
    listeners = [
        Box(230 + 200 * i, 180, name, kind="listener")
        for i, name in enumerate(("viewer", "recorder"))
    ]
    parts = (
        Machine(14, 30, 172, 92, "console"),
        Machine(244, 30, 172, 92, "router's machine"),
        Machine(474, 30, 172, 92, "robot"),
        *(middle, master, slave, *listeners),
        *(Line(one, middle) for one in (master, slave, *listeners)),
    )
    return svg(660, 220, "Console and robot meet at a router", parts)


def wide_area() -> str:
    """Return the drawing of a router on each site."""
    near = Box(300, 80, "router", "192.0.2.1:7450", "router")
    far = Box(560, 80, "router", "10.2.0.5:7450", "router")
    master, slave = Box(100, 80, "master"), Box(760, 80, "slave")
    viewer, recorder = (
        Box(100, 160, "viewer", kind="listener"),
        Box(760, 160, "recorder", kind="listener"),
    )
    parts = (
        *(Machine(14, 14, 366, 186, "console's site"), Machine(480, 14, 366, 186, "robot's site")),
        *(near, far, master, slave, viewer, recorder),
        Line(far, near, "wide area"),
        *(Line(one, near) for one in (master, viewer)),
        *(Line(one, far) for one in (slave, recorder)),
    )
    return svg(860, 214, "A router on each site of a wide-area network", parts)


def rooms() -> str:
    """Return the drawing of rooms of two arms behind one router."""
    middle = Box(480, 44, "router", "10.0.0.5:7450", "router")
    spare = Box(680, 44, "second router", "10.0.0.6:7450", "router")
    parts: list[Part] = [middle, spare, Line(spare, middle)]
    for room in range(3):
        left = 14 + 316 * room
        parts.append(Machine(left, 138, 300, 84, f"room {room + 1}"))
        for side, arm in enumerate(("left", "right")):
            name = f"room-{room + 1}-{arm}"
            pair = Box(left + 76 + 148 * side, 190, "master and slave", name)
            parts += [pair, Line(pair, middle)]
    return svg(960, 236, "Rooms of two arms behind one router", parts)


DRAWINGS = {
    "topology-one-machine.svg": one_machine,
    "topology-lan.svg": lan,
    "topology-router.svg": router,
    "topology-wide-area.svg": wide_area,
    "topology-rooms.svg": rooms,
}


def main() -> None:
    """Write all drawings."""
    for name, draw in DRAWINGS.items():
        (IMAGES / name).write_text(draw())


if __name__ == "__main__":
    main()
