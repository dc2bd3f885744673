"""The modes of control as people write them."""

MODES = ("hold", "joints", "test-1", "test-2", "test-all", "track", "follow")
