{%- for item in constants %}
{%- if item.unit %}
/* {{ item.meaning }} [{{ item.unit }}] */
static const double {{ item.name }} = {{ item.value | number }};
{%- else %}
/* {{ item.meaning }} */
#define {{ item.name }} {{ item.value | int }}
{%- endif %}
{%- endfor %}
