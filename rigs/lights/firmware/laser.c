/* Laser or lamp on an Arduino Uno (ATmega328P, 16 MHz) with a dead-man switch; the line is PB0 (Arduino pin 8).

   9600 baud, 8N1; lines end with LF (a CR before it is ignored):
     L1 on, L0 off, K "the host lives", ? state   -> "ON" or "OFF"
     I  who is there                              -> "LASER 1.2", also said at every reset
     anything else                                -> "ERR"; it changes nothing and is no sign of life
   No valid line for 0.4 s while the light is on: the timer's interrupt switches off, whatever the main loop does, and
   the line "TRIP" is sent unasked.

   Build and flash: README.md */
#include <avr/interrupt.h>
#include <avr/io.h>

#define LINE_UP() (PORTB |= 1)    /* one instruction each, so an interrupt cannot come in between */
#define LINE_DOWN() (PORTB &= ~1)
#define SILENCE_LIMIT 40          /* hundredths of a second: 0.39 to 0.40 s, as the phase falls */
#define UNREADABLE 0xFF           /* stands for a byte that the line damaged: no command holds it */
#define QUEUE 32                  /* a power of two; longer than any two commands */

static volatile unsigned char silence, on, tripped; /* `on`: QEMU 7.2 cannot read PORTB back */
static volatile unsigned char queue[QUEUE], head;
static unsigned char tail;

ISR(TIMER1_COMPA_vect) {
    if (on && ++silence >= SILENCE_LIMIT) {
        LINE_DOWN();
        on = 0;
        tripped = 1;
    }
}

ISR(USART_RX_vect) {
    unsigned char damaged = UCSR0A & ((1 << FE0) | (1 << DOR0)); /* must be read before UDR0 */
    unsigned char byte = UDR0;
    queue[head] = damaged ? UNREADABLE : byte;
    head = (head + 1) % QUEUE;
}

static void set(unsigned char wanted) {
    silence = 0;
    on = wanted;
    if (wanted) LINE_UP(); else LINE_DOWN();
}

static void say(const char *text) {
    for (; *text; text++) {
        while (!(UCSR0A & (1 << UDRE0))) {}
        UDR0 = *text;
    }
}

static void obey(const unsigned char *line, unsigned char length) {
    if (length == 2 && line[0] == 'L' && line[1] == '1') set(1);
    else if (length == 2 && line[0] == 'L' && line[1] == '0') set(0);
    else if (length == 1 && line[0] == 'I') { silence = 0; say("LASER 1.2\n"); return; }
    else if (length == 1 && (line[0] == 'K' || line[0] == '?')) silence = 0;
    else { say("ERR\n"); return; }
    say(on ? "ON\n" : "OFF\n");
}

int main(void) {
    unsigned char line[3], length = 0; /* the third byte only shows that a line is too long */
    LINE_DOWN();
    DDRB |= 1;
    UBRR0 = 103; /* 9600 baud */
    UCSR0B = (1 << RXEN0) | (1 << TXEN0) | (1 << RXCIE0);
    UCSR0C = 3 << UCSZ00;
    TCCR1B = (1 << WGM12) | (1 << CS12); /* clear on match, clock / 256 */
    OCR1A = 624;                         /* 100 Hz */
    TIMSK1 = 1 << OCIE1A;
    sei();
    say("LASER 1.2\n");
    for (;;) {
        if (tripped) {
            tripped = 0;
            say("TRIP\n");
        }
        if (tail == head) continue;
        unsigned char byte = queue[tail];
        tail = (tail + 1) % QUEUE;
        if (byte == '\n') {
            if (length) obey(line, length);
            length = 0;
        } else if (byte != '\r' && length < sizeof line) {
            line[length++] = byte;
        }
    }
}
