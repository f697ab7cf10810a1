"""The Pendubot: two links, one motor at the shoulder."""
