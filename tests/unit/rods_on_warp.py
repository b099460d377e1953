"""One member of rods that the GPU engine steps."""

from labbook_warp import Backend


def run(scene, how, start, beats, probes=(), lanes=None, device="cpu"):
    """One member, advanced: its packing and rows."""
    engine = Backend(lanes=lanes)
    ensemble = engine.open(engine.specialise(scene, how, probes), 1, device)
    member = ensemble.admit(scene, how, start)
    events = ensemble.advance(beats)
    assert not events, events
    state, tables = ensemble.packing(member), ensemble.drain()
    ensemble.close()
    return state, tables
