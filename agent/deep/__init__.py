"""Networks that all robots share: what they see, how they act, how they are trained (extra `deep`)."""
