/* libmodbus as a server; arguments and output as of modbus_tk_server.py.

   libmodbus_server (tcp PORT | rtu TTY) UNIT REGISTERS */

#include <modbus.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { REGISTERS = 400, WRITE_REGISTER = 6 };

static int fail(const char *what)
{
    perror(what);
    return 1;
}

int main(int count, char **arguments)
{
    if (count != 5)
        return 2;
    int is_tcp = strcmp(arguments[1], "tcp") == 0;
    modbus_t *link = is_tcp ? modbus_new_tcp("127.0.0.1", atoi(arguments[2]))
                            : modbus_new_rtu(arguments[2], 9600, 'N', 8, 1);
    modbus_mapping_t *map = modbus_mapping_new(0, 0, REGISTERS, 0);
    if (link == NULL || map == NULL || modbus_set_slave(link, atoi(arguments[3])))
        return fail("libmodbus");
    FILE *file = fopen(arguments[4], "r");
    if (file == NULL)
        return fail(arguments[4]);
    for (int address, value; fscanf(file, "%d %d", &address, &value) == 2;)
        map->tab_registers[address] = (uint16_t) value;
    fclose(file);
    int listener = is_tcp ? modbus_tcp_listen(link, 1) : 0;
    if (listener < 0 || (!is_tcp && modbus_connect(link)))
        return fail(arguments[2]);
    printf("listening\n");
    fflush(stdout);
    if (is_tcp)
        modbus_tcp_accept(link, &listener);
    for (;;) {
        uint8_t frame[MODBUS_TCP_MAX_ADU_LENGTH];
        int length = modbus_receive(link, frame);
        if (length < 0 && is_tcp)
            modbus_tcp_accept(link, &listener); /* the client has gone; the next one may come */
        if (length <= 0)
            continue;
        int header = modbus_get_header_length(link);
        modbus_reply(link, frame, length, map);
        if (frame[header] == WRITE_REGISTER) {
            int address = frame[header + 1] << 8 | frame[header + 2];
            printf("wrote %d %d\n", address, map->tab_registers[address]);
            fflush(stdout);
        }
    }
}
