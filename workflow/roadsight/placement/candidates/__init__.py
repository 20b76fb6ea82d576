"""Where sensors may stand, and the targets that they must see."""
