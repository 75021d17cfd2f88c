"""transparency.html: the study on one self-contained page."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from studies.transparency import figures, report, stiffness, zwidth
from studies.transparency.study import CONTACT, HANDS, LOAD, PRETENSION, SPRING, Case, Study
from teleop.cli.report.page import Page

TITLE = "Transparency and stability of the couplings"

MISSING = (
    "The rig is ideal: no friction, a tip without mass, a motor of 12.5 ms lag, and an estimator "
    "that knows it. What a sheath adds is not in here.",
    "One axis, one amplitude. The clamps and slew limits of both sides are at work in the walls, "
    "and not reached in the hybrid parameters.",
    "Hands and device are assumed, not measured; no hand has a tremor, a reflex or a grip that "
    "changes.",
    "Z-width: between the stiffnesses that were tried, and below the first that failed, stability "
    "is assumed to be of one piece.",
    "Stable means stable with these hands in this motion. Only Llewellyn's criterion speaks of "
    "all, and only of a linear system.",
    "A hand that is held or that goes its way gives and takes no energy that a passivity "
    "controller would refuse: h12 and h22 of a passivity coupling are those of a direct one.",
)


def render(study: Study, cases: list[Case]) -> str:
    """Return the page."""
    page = Page(TITLE)
    page.text(
        "The live code of both loops, with the bytes of their messages, between a simulated hand "
        "and a simulated tip. How much of a spring is felt; how stiff a wall may be before a hand "
        "in it is shaken; what the system is as a two-port, over frequency; and whether that is "
        "stable with any passive hand and tissue."
    )
    page.heading("In short")
    page.table(report.summary(study, cases), mark="")
    page.points(_columns(study))
    with TemporaryDirectory() as folder:
        captions = figures.draw(study, cases, Path(folder))

        def figure(name: str) -> None:
            page.figure(Path(folder) / name, captions[name])

        page.heading("Settings")
        page.points(_settings(study))
        _add_stiffness(page, study, cases, figure)
        _add_widths(page, study, cases, figure)
        _add_hybrid(page, study, cases, figure)
        _add_stability(page, figure, drawn="llewellyn.png" in captions)
    page.heading("What is not shown")
    page.points(MISSING)
    return page.render()


def _add_stiffness(
    page: Page, study: Study, cases: list[Case], figure: Callable[[str], None]
) -> None:
    """Add what is felt of a spring."""
    page.heading("Rendered against true stiffness")
    page.text(
        f"A hand that goes its way presses a spring in {stiffness.STEPS} steps, up to "
        f"{stiffness.FORCE:g} N at the tip, and rests after each. The slope of force over "
        "motion, at rest, is what is felt. A ripple of the force above "
        f"{report.RIPPLE:g} N is reported."
    )
    figure("stiffness.png")
    page.table(report.stiffnesses(study, cases), mark="")


def _add_widths(page: Page, study: Study, cases: list[Case], figure: Callable[[str], None]) -> None:
    """Add how stiff a wall may be."""
    page.heading("Z-width")
    page.text(
        f"A hand reaches through a contact, {1e3 * CONTACT:g} mm of the tip away, into a wall, "
        f"pushes with {zwidth.PUSH:g} N and rests for {zwidth.REST:g} s. Stable: its swing in "
        f"the last {zwidth.SPAN:g} s, beside its straight trend, is at most "
        f"{1e3 * zwidth.SWING:g} mm, or at most {zwidth.FADES:g} times that of the same time "
        f"before; on balance it never got more than {1e3 * zwidth.ENERGY:g} mJ out of the "
        "system; and the session is still engaged. The stiffness rises "
        f"{study.factor:g}-fold from {study.lowest:g} N/m until a wall is not stable; then it "
        f"is halved in to {100 * (study.within - 1.0):.0f} %. Buzz is the standard deviation "
        "of the force on the resting hand, in the stiffest stable wall."
    )
    figure("z-width.png")
    page.table(report.widths(study, cases), mark="")


def _add_hybrid(page: Page, study: Study, cases: list[Case], figure: Callable[[str], None]) -> None:
    """Add the two-port over frequency."""
    page.heading("Hybrid parameters")
    page.text(
        "f_h = h11 v_h + h12 f_e, −v_e = h21 v_h + h22 f_e (Hannaford 1989), f_h by the hand "
        "on the device, f_e against the tip's motion, the device included. First the hand is "
        f"moved by a multisine under a constant load of {LOAD:g} N, then it is held and the "
        f"load is a multisine. Per line: {1e3 * study.excitation.speed:g} mm/s of the tip, "
        f"{study.excitation.force:g} N; {study.excitation.draws} draws of phases, "
        f"{study.excitation.periods} periods of {study.excitation.period:g} s each. "
        "Coherence falls where an answer is noise or depends on the phases of other lines; "
        "distortion is the answer at harmonics that were not asked."
    )
    for name in study.couplings:
        figure(f"hybrid-{name}.png")
    page.table(report.quality(cases), mark="")


def _add_stability(page: Page, figure: Callable[[str], None], *, drawn: bool) -> None:
    """Add Llewellyn's criterion."""
    page.heading("Absolute stability")
    if drawn:
        page.text(
            "η = (2 Re h11 Re h22 − Re(h12 h21)) / |h12 h21| (Llewellyn 1952; Adams & "
            "Hannaford 1999). It is reported where the coupling's law is linear and the network "
            "constant; elsewhere it does not apply."
        )
        figure("llewellyn.png")
    else:
        page.text(
            "Llewellyn's criterion applies to linear systems with a constant network; none "
            "of these is one."
        )


def _columns(study: Study) -> list[str]:
    return [
        "felt: stiffness at the hand, in % of what the scales make of the true one.",
        f"Z-width: stiffest wall that is stable with the worse of two hands; ≥ {study.cap:g}: "
        f"nothing was unstable up to there; < {study.lowest:g}: not even that was stable.",
        "buzz: standard deviation of the force on a hand that rests in that wall, the worst.",
        "drag: Re h11, what a hand feels in free motion, the device's own damping of "
        f"{study.device.damping:g} N s/m included.",
    ]


def _settings(study: Study) -> list[str]:
    device = study.device
    return [
        f"Scales: force {study.force_scale:g}, motion {study.position_scale:g}.",
        f"Network: half of each round trip each way, jitter ±{1e3 * study.jitter:g} ms of the "
        f"round trip (never more than that itself), {100.0 * study.loss:g} % loss each way.",
        f"Device: {device.mass:g} kg, {device.damping:g} N s/m (Z-width: "
        f"{', '.join(f'{b:g}' for b in study.dampings)}), encoder of "
        f"{1e6 * device.resolution:g} µm, velocity filtered over {1e3 * device.smoothing:g} ms, "
        "force held for 1 ms.",
        *(
            f"Hand, {name}: {h.mass:g} kg, {h.stiffness:g} N/m, {h.damping:g} N s/m."
            for name, h in HANDS.items()
        ),
        f"Rig: one tendon of 6 kN/m, pretension {PRETENSION:g} N, for the walls a return spring "
        f"of {SPRING:g} N/m; tension noise 0.01 N.",
        *(_coupling(study, name) for name in study.couplings),
    ]


def _coupling(study: Study, name: str) -> str:
    """Return what is set of a coupling, in SI units and those of the tip."""
    values = asdict(study.coupling(name))
    values.pop("type")
    parameters = ", ".join(f"{key} {value:g}" for key, value in values.items())
    return f"Coupling {name}: {parameters or 'nothing to set'}."
