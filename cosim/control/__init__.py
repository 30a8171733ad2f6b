"""What runs on a robot every control period: where it thinks it is, and how it steers."""
