// The hardware around a GRBL 1.1 firmware that is compiled for a PC: serial line, step timer, motors, limit switches.
//
// A signal interrupts the firmware, as interrupts do on the board. Its handler lets the board's time go on, calls the
// firmware's handlers for what happened meanwhile, and sleeps a little, so that the firmware's loop leaves the computer
// some time. This file contains no code of the firmware; it is compiled together with the firmware's unchanged files.
//
//     board PORT_FD EEPROM_FILE STEPS_PER_UNIT X Y Z    positions at the start, in units below each switch
//
// Lines on standard input: "press X", "release X" (a finger on the switch), "cut X", "mend X" (its cable), "where".
// At the end of standard input the program ends and keeps the settings in EEPROM_FILE.
// Lines on standard output: the answer to "where", three positions in units, seen from the switches.

#define _GNU_SOURCE
#define BOARD_OWNS_REGISTERS
#include <avr/io.h>
#include <avr/interrupt.h>
#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { AXES = 3, EEPROM_BYTES = 1024, BYTES_IN_A_MS = 12, SWITCH_WIDTH = 1 };
static const double CLOCK_HZ = 16e6, MOST_US = 5000.0;  // the board's time goes on by so much at most in one step
static const int STEP_BIT[AXES] = {2, 3, 4}, DIRECTION_BIT[AXES] = {5, 6, 7}, LIMIT_BIT[AXES] = {1, 2, 4};

void TIMER1_COMPA_vect(void);
void TIMER0_OVF_vect(void);
void PCINT0_vect(void);
void USART_RX_vect(void);
void USART_UDRE_vect(void);
int grbl_main(void);
extern uint8_t serial_tx_buffer_head;
extern volatile uint8_t serial_tx_buffer_tail;

static volatile uint8_t memory[EEPROM_BYTES], control;
static const char *memory_file;
static int port;
static timer_t timer;
static volatile bool in_handler;
static volatile double now_us;
static double timer_us;
static long steps[AXES];
static double steps_per_unit;
static bool pressed[AXES], cut[AXES];

volatile uint8_t *eeprom_data(void) { return &memory[EEAR % EEPROM_BYTES]; }

volatile uint8_t *eeprom_control(void) {
    if ((control & (1 << EEMPE)) && (control & (1 << 4))) memory[EEAR % EEPROM_BYTES] = 0xFF;  // erase only
    control &= (uint8_t)~((1 << EEPE) | (1 << EEMPE));
    return &control;
}

static void keep_memory(void) {
    int file = open(memory_file, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    if (file >= 0 && write(file, (const void *)memory, EEPROM_BYTES) == EEPROM_BYTES) close(file);
}

static void read_switches(void) {
    uint8_t pins = 0xFF;  // pulled up; a closed switch pulls down
    for (int axis = 0; axis < AXES; axis++)
        if (!cut[axis] && (pressed[axis] || steps[axis] >= 0)) pins &= (uint8_t)~(1 << LIMIT_BIT[axis]);
    uint8_t changed = PINB ^ pins;
    PINB = pins;
    if ((changed & PCMSK0) && (PCICR & (1 << PCIE0))) PCINT0_vect();
}

static void turn_motors(void) {
    for (int axis = 0; axis < AXES; axis++)
        if (PORTD & (1 << STEP_BIT[axis])) steps[axis] += PORTD & (1 << DIRECTION_BIT[axis]) ? -1 : 1;
    read_switches();
}

static void run_step_timer(void) {
    while (TIMSK1 & (1 << OCIE1A)) {
        double period_us = 1e6 * (OCR1A + 1.0) / CLOCK_HZ;
        if (timer_us + period_us > now_us) return;
        timer_us += period_us;
        TIMER1_COMPA_vect();
        turn_motors();
        TIMER0_OVF_vect();
    }
    timer_us = now_us;
}

static void serve_line(void) {
    uint8_t byte;
    for (int i = 0; i < BYTES_IN_A_MS && read(port, &byte, 1) == 1; i++) {
        UDR0 = byte;
        USART_RX_vect();
    }
    for (int i = 0; i < BYTES_IN_A_MS && (UCSR0B & (1 << UDRIE0)); i++) {
        if (serial_tx_buffer_head == serial_tx_buffer_tail) {  // set once more while this handler interrupted the setting
            UCSR0B &= (uint8_t)~(1 << UDRIE0);
            break;
        }
        USART_UDRE_vect();
        byte = UDR0;
        if (write(port, &byte, 1) != 1) break;
    }
}

static void obey(void) {
    static char line[32];
    static size_t length;
    char byte;
    ssize_t got;
    while ((got = read(STDIN_FILENO, &byte, 1)) == 1) {
        if (byte != '\n') {
            if (length + 1 < sizeof line) line[length++] = byte;
            continue;
        }
        line[length] = 0;
        const char *letter = strchr(line, ' ');
        int axis = letter ? letter[1] - 'X' : 0;
        if (!strncmp(line, "press", 5)) pressed[axis] = true;
        if (!strncmp(line, "release", 7)) pressed[axis] = false;
        if (!strncmp(line, "cut", 3)) cut[axis] = true;
        if (!strncmp(line, "mend", 4)) cut[axis] = false;
        if (!strncmp(line, "where", 5)) {
            char text[96];
            int said = snprintf(text, sizeof text, "%.4f %.4f %.4f\n", steps[0] / steps_per_unit,
                                steps[1] / steps_per_unit, steps[2] / steps_per_unit);
            if (write(STDOUT_FILENO, text, (size_t)said) != said) _exit(1);
        }
        length = 0;
        read_switches();
    }
    if (got == 0) {  // the test has ended
        keep_memory();
        _exit(0);
    }
}

static void wait_for_the_next(void) {
    struct itimerspec soon = {{0, 0}, {0, 300000}};
    timer_settime(timer, 0, &soon, NULL);
}

static void interrupt(int number) {
    (void)number;
    static double seen_us;
    struct timespec moment;
    clock_gettime(CLOCK_MONOTONIC, &moment);
    double real_us = 1e6 * (double)moment.tv_sec + 1e-3 * (double)moment.tv_nsec;
    double passed_us = seen_us ? real_us - seen_us : 0.0;
    in_handler = true;
    if (SREG & 0x80) {
        seen_us = real_us;
        now_us += passed_us < MOST_US ? passed_us : MOST_US;
        obey();
        serve_line();
        run_step_timer();
        SREG |= 0x80;
        struct pollfd waiting = {port, POLLIN, 0};
        poll(&waiting, 1, 1);
    }
    in_handler = false;
    wait_for_the_next();
}

void board_delay_us(double us) {
    if (in_handler) {  // a handler of the firmware waits; the signal cannot interrupt itself
        now_us += us;
        return;
    }
    for (double until_us = now_us + us; now_us < until_us;) usleep(200);
}

int main(int count, char **given) {
    if (count != 7) return 2;
    port = atoi(given[1]);
    memory_file = given[2];
    steps_per_unit = atof(given[3]);
    for (int axis = 0; axis < AXES; axis++) steps[axis] = (long)(-steps_per_unit * atof(given[4 + axis]));
    memset((void *)memory, 0xFF, EEPROM_BYTES);
    int file = open(memory_file, O_RDONLY);
    if (file >= 0 && read(file, (void *)memory, EEPROM_BYTES) != EEPROM_BYTES) return 3;
    fcntl(port, F_SETFL, O_NONBLOCK);
    fcntl(STDIN_FILENO, F_SETFL, O_NONBLOCK);
    PINB = PINC = PIND = 0xFF;
    read_switches();
    struct sigaction action = {.sa_handler = interrupt};
    sigaction(SIGALRM, &action, NULL);
    struct sigevent event = {.sigev_notify = SIGEV_SIGNAL, .sigev_signo = SIGALRM};
    timer_create(CLOCK_MONOTONIC, &event, &timer);
    wait_for_the_next();
    return grbl_main();
}
