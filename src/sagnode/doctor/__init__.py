"""Doctor: looks a node over before it is trusted, check by check, and packs what a person far away needs to help."""
