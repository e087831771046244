"""stub"""
def page(plan, grid=None):
    """Stub."""
    return "<!doctype html>"
