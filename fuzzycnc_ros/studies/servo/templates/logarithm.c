static double natural_log(double x)
{
    static const double log[] = { {{ log | join(', ') }} };
    int exponent;
    double part = frexp(x, &exponent), rise, s, square, half, more, whole;

    if (part < {{ root_half }}) {
        part = 2.0 * part;
        exponent--;
    }
    whole = exponent;
    rise = part - 1.0;
    s = rise / (2.0 + rise);
    square = s * s;
    half = 0.5 * rise;
    half *= rise;
    more = square * polynomial(log, 7, square);
    more += half;
    more *= s;
    more += whole * {{ ln2_low }};
    half -= more;
    half -= rise;
    return whole * {{ ln2_high }} - half;
}
