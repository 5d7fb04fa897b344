// Delays follow the time of the simulated board, which stands still while this computer is too busy.
void board_delay_us(double us);
#define _delay_us(us) board_delay_us(us)
#define _delay_ms(ms) board_delay_us(1e3 * (ms))
