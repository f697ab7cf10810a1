"""Commands about code: generate, verify, build."""
