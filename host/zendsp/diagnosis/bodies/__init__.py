"""Wrong bodies of the whole machine, looked for before its joints: a payload, a link, gravity."""
