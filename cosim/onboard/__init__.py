"""What runs on a robot: where it thinks it is, what it sees, how it steers and who yields."""
