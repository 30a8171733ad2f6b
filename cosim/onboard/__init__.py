"""What runs on a robot: estimate, observation, steering, shield, yielding rule."""
