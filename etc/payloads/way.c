/* A payload in C: how far the boat has sailed, from its speed over ground, and how fast it was at most.
 *
 *     cc -O2 -o way way.c -lm
 *
 * It reads lines of JSON that are flat, so that looking for a name is enough. */

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* The number behind a name; not a number where there is none, or null. */
static double value(const char *line, const char *name)
{
    const char *found = strstr(line, name);
    char *end;

    if (found == NULL)
        return NAN;
    found += strlen(name);
    double number = strtod(found, &end);
    return end == found ? NAN : number;
}

int main(void)
{
    char line[4096];
    double way_m = 0.0, fastest_mps = 0.0, before_s = NAN;

    setvbuf(stdout, NULL, _IOLBF, 0);
    while (fgets(line, sizeof line, stdin) != NULL) {
        double now_s = value(line, "\"utc_ns\":") / 1e9;
        double speed_mps = hypot(value(line, "\"north_mps\":"), value(line, "\"east_mps\":"));

        if (isnan(now_s) || isnan(speed_mps)) /* an event, or a boat that does not know how fast it is */
            continue;
        if (now_s > before_s && now_s - before_s < 2.0)
            way_m += speed_mps * (now_s - before_s);
        before_s = now_s;
        fastest_mps = fmax(fastest_mps, speed_mps);
        printf("{\"way_m\": %.1f, \"fastest_mps\": %.2f}\n", way_m, fastest_mps);
    }
    return 0;
}
