"""Explicit time integration: soft bodies, rigid bodies, contact and commands over time."""
