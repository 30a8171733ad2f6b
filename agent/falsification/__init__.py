"""The worst episodes of a policy: searched for within declared ranges, kept as regression cases."""
