"""Contact in compiled code: whole steps of Moreau's scheme, and the small problems of forces of other schemes."""
