"""What motor speeds do: trials of single robots, and the map that turns drive speeds into them."""
