"""The TORA: a rotor with an eccentric mass damps a cart on a spring."""
