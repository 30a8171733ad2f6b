"""Software of a robot's microcontroller: C sources, and the tables of a policy for them."""
