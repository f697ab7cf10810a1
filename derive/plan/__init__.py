"""Planned motions: a trajectory to the setpoint, checked against the ODE, with a Riccati row."""
