"""Commands about the paper: audit, reproduce."""
