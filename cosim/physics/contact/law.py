"""Choice of the law of contact by the class of its parameters, when a kernel is compiled.

A law has a record of parameters with `pairing`, `feet`, `z` and `mu`, and three functions: how the
record is made of a robot, how it is read from rows of properties, and the response of the floor.
"""

from typing import Any

from cosim.base.jit import by_class
from cosim.physics.contact import elastic, rigid

# Angular velocity after a step, sum of the impulses, and feet: response(contact, params, body,
# world_from_body, velocity, omega), with velocities (body frame) that the body would have without.
response: Any = by_class({rigid.Rigid: rigid.response, elastic.Elastic: elastic.response})
read_contact: Any = by_class({rigid.Rigid: rigid.read, elastic.Elastic: elastic.read})
