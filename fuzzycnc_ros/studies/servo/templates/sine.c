/* Sine of an angle [rad]; of fdlibm 5.3, too. */
static double sine(double x)
{
    static const double sin[] = { {{ sin | join(', ') }} }, cos[] = { {{ cos | join(', ') }} };
    double quarters = rint(x * {{ per_quarter }}), first = x - quarters * {{ quarter[0] }};
    double part = quarters * {{ quarter[1] }}, second = first - part, rest, more, square, found;
    long long turn = (long long)quarters;

    part = quarters * {{ quarter[2] }} - ((first - second) - part);
    rest = second - part;
    more = (second - rest) - part;
    square = rest * rest;
    if (turn % 2) {
        double half = 0.5 * square, near = 1.0 - half;
        double high = square * square * polynomial(cos, 6, square);
        found = near + (((1.0 - near) - half) + (high - rest * more));
    } else {
        double cube = square * rest, high = polynomial(sin, 5, square);
        found = rest - ((square * (0.5 * more - cube * high) - more) - cube * sin[5]);
    }
    return ((turn % 4) + 4) % 4 > 1 ? -found : found;
}
