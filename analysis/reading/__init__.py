"""Result files and where they lie, and what looks wrong in an episode."""
