"""The parts of the reproduction that need the derivation: a second formulation, the certificate."""
