"""The 1-DOF platform of Eq. (1), Fig. 2 and 3: sliding under a turning eccentric mass."""
