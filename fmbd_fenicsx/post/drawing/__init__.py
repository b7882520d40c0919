"""One drawing of a run, as data: what pictures, animations, web pages and ParaView files are made of."""
