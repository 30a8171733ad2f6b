"""Software of a robot: estimate, observation, steering, shield, yielding rule."""
