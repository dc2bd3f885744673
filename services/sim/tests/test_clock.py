from armsight_sim.clock import Instants, Lockstep, Pacer

START = 1_700_000_000_000_000_000


def test_instants_are_exact_for_ever() -> None:
    instants = Instants(START, 30)
    assert instants.capture_ns(0) == START
    assert instants.capture_ns(30 * 3600 * 24) == START + 24 * 3600 * 1_000_000_000
    steps = {instants.capture_ns(i + 1) - instants.capture_ns(i) for i in range(1000)}
    assert steps == {33_333_333, 33_333_334}


def test_pacer_keeps_the_rate_and_forgives_one_late_frame() -> None:
    pacer = Pacer(30, 100.0)
    pacer.taken(100.001)
    assert abs(pacer.due_s - (100.0 + 1 / 30)) < 1e-9
    pacer.taken(101.0)  # a second late: no burst of thirty frames to catch up
    assert abs(pacer.due_s - (101.0 + 1 / 30)) < 1e-9


def test_lockstep_waits_for_the_answer_to_its_own_instant() -> None:
    lockstep = Lockstep()
    lockstep.sent(5, 0.0)
    assert not lockstep.answered(4)
    assert lockstep.waiting
    assert lockstep.answered(5)
    assert not lockstep.waiting


def test_frames_are_sent_again_late_or_soon_after_a_reader_appeared() -> None:
    lockstep = Lockstep()
    lockstep.sent(5, 0.0)
    assert not lockstep.resend_due(5.9)
    assert lockstep.resend_due(6.1)
    lockstep.reader_appeared(1.0)
    assert lockstep.resend_due(1.0)
    lockstep.sent(5, 1.0)
    assert not lockstep.resend_due(1.4)
    assert lockstep.resend_due(1.6)
    lockstep.answered(5)
    assert not lockstep.resend_due(100.0)
