"""The acrobot: two links, one motor at the elbow."""
