"""The control laws: sampled, continuous, along a reference, and the swing-up."""
