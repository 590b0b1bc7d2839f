"""GPS's week number begins anew every 1024 weeks, last in 2019: receivers that ignore it report earlier dates.

Not every earlier date is such a one. A receiver that does not know the week number yet, or at all, may say 1980, and
others the date at which their own clock begins: 1024 weeks later that is still before this program was written.
"""

from datetime import date, timedelta

from imud.drivers.fix import Fix

_LAST, _PERIOD = date(2019, 4, 7), timedelta(weeks=1024)
_WRITTEN = date(2026, 1, 1)  # no fix that is made while this program runs is from before


def without_rollover(fix: Fix) -> Fix:
    """With the date that the receiver means, if it has been made now: none is from before the last rollover.

    Without a date if it cannot mean any.
    """
    if fix.date is None or fix.date >= _LAST:
        return fix
    meant = fix.date
    while meant < _LAST:
        meant += _PERIOD
    return fix._replace(date=meant if meant >= _WRITTEN else None)
