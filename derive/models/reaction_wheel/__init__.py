"""The reaction-wheel pendulum: a motor on the pendulum spins a wheel against it."""
