"""Laws of contact between feet and floor, one per file.

The class of its parameters chooses a law when a kernel is compiled (`cosim.base.jit.by_class`). It
has a record of them with `pairing`, `feet`, `z`, `mu` and `legs`, what makes the record of a robot,
`read`, which takes what a world changes from rows of properties, and `response`: what the floor
does to a body in a step, from the velocities (body frame) that the body would have without.
"""
