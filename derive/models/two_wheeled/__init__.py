"""The two-wheeled robot: motors between body and wheels keep the body upright."""
