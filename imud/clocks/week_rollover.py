"""GPS's week number begins anew every 1024 weeks, last in 2019: receivers that ignore it report earlier dates."""

from datetime import date, timedelta

from imud.drivers.fix import Fix

_LAST, _PERIOD = date(2019, 4, 7), timedelta(weeks=1024)


def without_rollover(fix: Fix) -> Fix:
    """With the date that the receiver means, if it has been made now: none is from before the last rollover."""
    while fix.date is not None and fix.date < _LAST:
        fix = fix._replace(date=fix.date + _PERIOD)
    return fix
