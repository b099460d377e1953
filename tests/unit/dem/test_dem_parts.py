"""Which spring goes on where as the parts of a rod at a wall change: every case."""

from labbook_dem.rods import spring_source


def parts(bits: int) -> set[int]:
    return {part for part in range(4) if bits >> part & 1}


def test_no_spring_is_lost_in_a_hand_over_or_given_twice():
    for was in range(16):
        for now in range(16):
            sources = {part: spring_source(part, was, now) for part in parts(now)}
            given = [old for old in sources.values() if old >= 0]
            assert len(given) == len(set(given)), (was, now)
            assert set(given) <= parts(was)
            for part, old in sources.items():
                if part in parts(was):
                    assert old == part, "what goes on keeps its own"
                elif old >= 0:
                    assert old in parts(was) - parts(now)
            if len(parts(now) - parts(was)) == 1 and parts(was) - parts(now):
                assert any(old not in parts(now) for old in given), "one that begins takes over from one that ends"


def test_an_end_that_slides_over_an_edge_takes_its_spring_along():
    assert spring_source(2, 0b0001, 0b0100) == 0
    assert spring_source(0, 0b0110, 0b0011) == 2
    assert spring_source(3, 0b0011, 0b1001) == 1
    assert spring_source(2, 0b0011, 0b1100) == 0
    assert spring_source(3, 0b0011, 0b1100) == 1
    assert spring_source(3, 0b0001, 0b1001) == -1
