"""The contract and the bus that every armsight service shares: messages, keys, sessions."""
