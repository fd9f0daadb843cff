"""Hyperelastic laws, their fit to tests, where they are stable, and a library of materials."""
