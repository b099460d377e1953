"""At a wall a rod may touch at several points, its parts, each with a spring of its own: which spring goes on where.

As an end slides from a plate over its edge, its contact ends as part 0 and begins as part 2, at the same point. Part 0
is the end at -h and part 1 that at +h; part 2 is the edge nearer to the first, part 3 that nearer to the second.
"""

from labbook_dem.words import func


@func
def has(parts: int, part: int):
    """Whether a set of parts, as bits, holds a part."""
    return ((parts >> part) & 1) == 1


@func
def heir(part: int, was: int, now: int):
    """The part whose spring `part` goes on with: its own, that of one that has ended as it began, or -1 for none.

    was, now: the parts that touched at the last step and that touch now, as bits. No spring goes to two parts: a part
    that has ended is left to the one on its own side (0 and 2, 1 and 3), else to the other edge or end across, else to
    its like.
    """
    ended = was & ~now
    begun = now & ~was
    own = part ^ 2
    across = part ^ 3
    like = part ^ 1
    takes_across = has(ended, across) and not has(begun, across ^ 2)
    takes_like = has(ended, like) and not has(begun, like ^ 2) and not has(begun, like ^ 3)
    other = across if takes_across else (like if takes_like else -1)
    return part if has(was, part) else (own if has(ended, own) else other)
