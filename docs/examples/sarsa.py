"""SARSA, as a method of one's own: `--method docs.examples.sarsa:sarsa` of `minirobots run`."""

from agent.training.methods import learner


@learner()
def sarsa(q, s, a, reward, discount, s_next, a_next, eta, coin):
    """SARSA: learns the values of what it does, exploration included."""
    q[0, s, a] += eta * (reward + discount * q[0, s_next, a_next] - q[0, s, a])
