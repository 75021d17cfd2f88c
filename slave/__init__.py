"""The tendon side: rigs, plant, tendon control, the slave loop, commands on rig data."""
