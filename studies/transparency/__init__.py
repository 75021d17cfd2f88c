"""Transparency and stability of couplings, with the live loops of both sides.

`system` is the master's and the slave's steps with a simulated network between them, and a hand's
runs on it; `hand` and `rig` are what is at its ends. `stiffness`, `zwidth` and `hybrid` are what is
measured, `study` for every coupling and delay (studies/results/coupling.md).

It imports both master and slave, so nothing else imports it.
"""
