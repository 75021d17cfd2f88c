"""Rigs on models of their hardware: the main job of each driver, achieved rates and CPU."""
