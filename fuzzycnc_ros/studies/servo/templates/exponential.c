/* Polynomials and parts of constants of fdlibm 5.3: the same digits everywhere, without a libm's pow. */
static double polynomial(const double *coefficients, int size, double x)
{
    double total = x * coefficients[0];
    int place;

    for (place = 1; place < size - 1; place++) {
        total += coefficients[place];
        total *= x;
    }
    return total + coefficients[size - 1];
}

static double exponential(double x)
{
    static const double exp[] = { {{ exp | join(', ') }} };
    double halvings, rest, square, c, below;

    if (!(x > -746.0))
        return x < 0.0 ? 0.0 : x;
    halvings = rint(x * {{ per_ln2 }});
    rest = (x - halvings * {{ ln2_high }}) - halvings * {{ ln2_low }};
    square = rest * rest;
    c = rest - square * polynomial(exp, 5, square);
    below = 2.0 - c;
    c *= rest;
    c /= below;
    c += rest;
    return ldexp(1.0 + c, (int)halvings);
}
