"""How many examples Hypothesis tries."""

from hypothesis import HealthCheck, settings

USUAL = 100  # of Hypothesis; the profile `nightly` has more


def examples(count: int) -> settings:
    """So many examples, and as many more as the profile has more than usual."""
    profile = settings.get_profile(settings.get_current_profile_name())
    return settings(
        max_examples=count * profile.max_examples // USUAL,
        suppress_health_check=[
            HealthCheck.data_too_large,
            HealthCheck.filter_too_much,
            HealthCheck.function_scoped_fixture,
            HealthCheck.too_slow,
        ],
    )
