"""Co-simulation of mini-robots: parameters, rigid body, contact, master, steering, recording."""
