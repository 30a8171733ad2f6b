"""Networks that all robots share: what they see, how they act, and how they are trained."""
