// A PC has one memory.
#define __flash
#define PSTR(text) (text)
#define pgm_read_byte_near(place) (*(const char *)(place))
