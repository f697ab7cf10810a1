"""Commands that fly: simulate, pil, campaign, run."""
