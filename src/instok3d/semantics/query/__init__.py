"""Questions about a room: what they say, which objects they may mean, how likely that is."""
