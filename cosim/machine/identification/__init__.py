"""System identification: what a robot's parameters are, from tracks seen by a camera."""
