"""What learning counts: which pattern each transition shows, and how often activities change things."""

import dataframely as dy


class Sightings(dy.Schema):
    """One row per transition: the pattern that it shows, and what the pattern's variables stand for in it.

    Of an episode, this depends on nothing but the episode and on which activities usually make which change.
    Rows of several episodes are simply put together; counts are how many rows there are.
    """

    episode_id = dy.String(primary_key=True, description="The demonstration")
    hand = dy.String(primary_key=True, description="Hand instance")
    start_ns = dy.Int64(primary_key=True, description="First tick of the activity", metadata={"unit": "ns"})
    end_ns = dy.Int64(description="First tick after it", metadata={"unit": "ns"})
    pattern = dy.String(description="Name of the pattern: hash of what it says")
    binding = dy.List(
        dy.String(nullable=True), description="Instance of each variable, in order; null where it has none"
    )


class Patterns(dy.Schema):
    """One row per distinct lifted transition; atoms are over variables, by their position: onTop(1,2)."""

    pattern = dy.String(primary_key=True, description="Its name: hash of what it says")
    activity = dy.String(description="Activity that it leads into")
    is_first = dy.Bool(description="Nothing came before it: the hand's episode begins with it")
    grip = dy.String(description="What became of the hand's hold: free, grasps, holds, …")
    types = dy.List(dy.String(nullable=True), description="Type of each variable; null where it has none")
    before = dy.List(dy.String(), description="Atoms true before, sorted")
    after = dy.List(dy.String(), description="Atoms true after, sorted")
    unknown_before = dy.List(dy.String(), description="Atoms unknown before, sorted")
    unknown_after = dy.List(dy.String(), description="Atoms unknown after, sorted")


class Votes(dy.Schema):
    """One row per activity and kind of change that it was seen to make within itself; counts add up."""

    activity = dy.String(primary_key=True, description="Name of the activity")
    old = dy.Int64(primary_key=True, description="Kind of value before: 1 an object, negative what is none")
    new = dy.Int64(primary_key=True, description="Kind of value after")
    n_transitions = dy.Int64(min=0, description="How often")
