/* machine_config.h: read the "key = value" lines that a machine is opened with. */
#ifndef ZENDSP_MACHINE_CONFIG_H
#define ZENDSP_MACHINE_CONFIG_H

#include <stdio.h>  /* snprintf */
#include <stdlib.h> /* strtod */
#include <string.h> /* strchr, strlen, strncmp */

/* Every key that was asked for, a line each, so that one which nobody asks for is no setting of the
 * machine. Empty again where they are too many. */
__attribute__((weak, visibility("default"))) char machine_config_asked[4096] = "\n";

static inline void machine_config_ask(const char *key) {
    char line[80];
    const size_t used = strlen(machine_config_asked), room = sizeof machine_config_asked - used;
    snprintf(line, sizeof line, "\n%s\n", key);
    if (used == 0 || strstr(machine_config_asked, line))
        return;
    if (strlen(line) >= room)
        machine_config_asked[0] = 0;
    else
        snprintf(machine_config_asked + used, room, "%s", line + 1);
}

/* Copy the text after "key =" into `value` (trimmed); returns 0, or -1 when the key is absent. */
static inline int machine_config_text(const char *config, const char *key, char *value,
                                      size_t size) {
    const size_t length = strlen(key);
    machine_config_ask(key);
    for (const char *line = config; line && *line;) {
        const char *end = strchr(line, '\n');
        const char *stop = end ? end : line + strlen(line);
        while (line < stop && (*line == ' ' || *line == '\t'))
            line++;
        if ((size_t)(stop - line) > length && strncmp(line, key, length) == 0) {
            const char *at = line + length;
            while (at < stop && (*at == ' ' || *at == '\t'))
                at++;
            if (at < stop && *at == '=') {
                at++;
                while (at < stop && (*at == ' ' || *at == '\t'))
                    at++;
                while (stop > at && (stop[-1] == ' ' || stop[-1] == '\t' || stop[-1] == '\r'))
                    stop--;
                snprintf(value, size, "%.*s", (int)(stop - at), at);
                return 0;
            }
        }
        line = end ? end + 1 : NULL;
    }
    return -1;
}

/* The number after "key =", or `otherwise`. */
static inline double machine_config_double(const char *config, const char *key, double otherwise) {
    char text[64];
    if (machine_config_text(config, key, text, sizeof text) != 0)
        return otherwise;
    char *end = NULL;
    const double value = strtod(text, &end);
    return end != text ? value : otherwise;
}

#endif
