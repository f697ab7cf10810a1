"""Flights: scenarios, the closed loop on one machine or another, and what is measured of it."""
