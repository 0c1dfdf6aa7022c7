"""Planning: what accuracy a camera, a lens and a place will give, before anyone climbs."""
